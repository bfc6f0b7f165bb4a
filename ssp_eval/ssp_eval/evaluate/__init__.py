"""The way from bags to scored cells: requests, raw answers, records, scores."""
