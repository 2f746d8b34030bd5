"""`python -m deploy` is `fastslow`."""

from deploy.cli.app import main

main()
