"""`python -m climbplan` is the command `climbplan`."""

from climbplan.cli.app import main

if __name__ == "__main__":
    main()
