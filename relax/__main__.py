"""`python -m relax`: the command line."""

from relax.cli import main

if __name__ == "__main__":
    main()
