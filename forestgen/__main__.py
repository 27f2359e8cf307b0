"""`python -m forestgen` and the installed command."""

from forestgen.cli import main

if __name__ == "__main__":
    main()
