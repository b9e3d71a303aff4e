"""The public set of contact problems: families drawn from seeds, their files, and a checker."""
