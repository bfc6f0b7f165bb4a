"""The files of an evaluation: labels, records, audits, provenance of recordings."""
