"""Composes the nodes: the process table, the supervisor, the command line."""
