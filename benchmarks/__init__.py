"""Comparison tables, each figure beside a named alternative of the same run."""
