"""How the intent parser of the slow system is made: commands by hand, composed by a generator, and learnt from."""
