"""The probe: asks an object for what ISO 22133 promises; the gateway knows its report alone."""
