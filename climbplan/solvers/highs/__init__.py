"""HiGHS: instances, and linear programs as they stand."""
