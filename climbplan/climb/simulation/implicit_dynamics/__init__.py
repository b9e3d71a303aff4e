"""Dynamics of braced robots by implicit time steps: many scenarios a second, from a plan's arrays.

Users select this engine by the name `statics`: its long steps are quasi-static.
"""
