"""The figures of a paper from recordings and results, and a page that holds them."""
