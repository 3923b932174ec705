"""`python -m svmdist` is the command `svmdist`."""

from svmdist.cli.main import run

if __name__ == "__main__":
    run()
