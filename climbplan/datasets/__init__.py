"""Datasets: rows sampled and solved in parallel, kept in shards, resumed, put together."""
