"""`python -m benchmarks NAME [options]`, from the repository's root."""

from benchmarks.app import app

if __name__ == "__main__":
    app(prog_name="python -m benchmarks")
