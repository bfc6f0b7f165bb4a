"""Makes bags of what others recorded, so that it is audited and evaluated like any recording."""
