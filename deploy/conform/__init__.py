"""A third party's simulator or driver, tried on the bus: which of the protocol's duties it keeps."""
