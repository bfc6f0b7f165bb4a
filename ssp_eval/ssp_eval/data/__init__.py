"""What the files of an evaluation say: labels, records, audits, provenance of recordings."""
