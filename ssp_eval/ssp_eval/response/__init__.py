"""The comparison of the VUT's response in the recordings of one event (docs/audit.md)."""
