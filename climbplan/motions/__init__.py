"""Motions in the NPZ layout that motion-tracking pipelines read: written, read and measured."""
