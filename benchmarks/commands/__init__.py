"""Subcommands by family: each has the options of its benchmark and no others."""
