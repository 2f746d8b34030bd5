"""A run in a file: MCAP that Foxglove, Lichtblick and PlotJuggler open, and that reads back bit for bit."""
