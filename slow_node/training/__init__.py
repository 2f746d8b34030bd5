"""How the slow system's reader is made: commands written by hand, composed by a seeded generator, and learnt from."""
