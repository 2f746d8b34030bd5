"""SUMO's drivers in the other cars: a scenario's road and traffic in SUMO, the ego by our executor.

The ego is moved by its own kinematics, and put where it is into SUMO at every tick, so that the others see it.
"""
