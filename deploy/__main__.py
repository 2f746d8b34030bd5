"""`python -m deploy` is `fastslow`."""

from deploy.cli import main

main()
