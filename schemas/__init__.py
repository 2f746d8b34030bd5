"""The contract: what travels on the bus, how it is encoded, and what its numbers mean.

Imports none of the other packages; everything else imports this one.
"""
