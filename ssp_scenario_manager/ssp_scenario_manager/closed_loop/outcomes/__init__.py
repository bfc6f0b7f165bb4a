"""The judgement of driven runs: outcome, severity, rates (METHOD 8.5 to 8.8)."""
