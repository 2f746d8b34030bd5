"""`fastslow bench`: what the runtime costs, measured on the real processes."""
