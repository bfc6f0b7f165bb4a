"""Did the VUT respond alike in the recordings of one event? (docs/audit.md, The same response)"""
