"""Messages, objects, gateways and probes of ISO 22133."""
