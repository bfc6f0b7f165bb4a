"""The folder of a cell: questions, raw answers, records and scores, written and read back."""
