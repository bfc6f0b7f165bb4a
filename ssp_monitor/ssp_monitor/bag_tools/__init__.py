"""The verbs of ``ssp bag``: info, check, recover, cut, export and record."""
