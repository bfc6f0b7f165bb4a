"""When a trigger fires: conditions, their evaluation, whether they could fire at all."""
