"""The probe of an object against ISO 22133; the gateway only knows its report."""
