"""The models of a campaign, and the ways to them: in this process, over topics, by bridges."""
