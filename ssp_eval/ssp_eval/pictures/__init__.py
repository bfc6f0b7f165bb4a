"""Pictures held against recorded states: do they show what the states say? (METHOD 4.3, 4.4)."""
