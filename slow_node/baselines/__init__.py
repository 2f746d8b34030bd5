"""Language drivers to compare with."""
