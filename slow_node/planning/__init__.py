"""From slots and scene to a directive and a sentence."""
