"""Reformulations: from one statement to the forms that methods solve, and back.

Each says what it accepts, applies itself to an instance, and inverts a solution into the variables
of the statement.
"""
