"""The cockpit: a process of its own that shows a running car, or a recording of one, on a local page."""
