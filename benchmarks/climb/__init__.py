"""Benchmarks of climbs, each beside a named alternative of the same run."""
