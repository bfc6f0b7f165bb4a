"""What road users do and where they are."""
