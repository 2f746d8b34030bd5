"""Films: a drive as a moving picture, without a screen."""
