"""Diagnosis of this host: installed and missing parts, and the connections of a session."""
