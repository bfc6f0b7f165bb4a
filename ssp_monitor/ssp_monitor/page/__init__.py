"""The operators' page: a web server of its own beside a session, fed by its topics."""
