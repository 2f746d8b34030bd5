"""The compiled tick: highway-env 1.12.1 bit for bit, in its order, on arrays.

One tick is what `AbstractEnv._simulate` does in one frame: the ego's action (`ego`); every vehicle in turn acts
(`drivers`: IDM, MOBIL reading the new targets of those before it); every vehicle steps (`motion`); every pair is
checked for collisions (`collisions`). `tick` has the two entries, `layout` the arrays. Work is left out only where its
result provably cannot matter; what is computed is computed in upstream's order of operations.

The functions are plain Python that only runs compiled: `loops` calls numpy's own machine code.

Axes: S scenes, V vehicles (upstream's list, then its objects), L lanes. SI units.
"""
