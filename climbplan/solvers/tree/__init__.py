"""Branch and bound over the choices of an instance, with re-solved quadratic programs as nodes."""
