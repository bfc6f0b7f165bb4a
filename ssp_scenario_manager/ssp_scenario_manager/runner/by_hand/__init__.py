"""A run that is driven command by command, so that it can wait between arming and start."""
