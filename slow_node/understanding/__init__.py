"""From words to slots."""
