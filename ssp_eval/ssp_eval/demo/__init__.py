"""The demonstration: both scenarios in three domains, through all verbs of the command line."""
