"""Writers of a bag: MCAP files, their chunks, their index and their digest chain."""
