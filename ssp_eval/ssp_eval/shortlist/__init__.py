"""The funnel of SSP: which events of the two virtual stages are worth a day on the track."""
