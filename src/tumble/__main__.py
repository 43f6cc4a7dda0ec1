"""`python -m tumble`: the command line, where `tumble` is not on the path."""

from tumble.cli import main

if __name__ == "__main__":
    main(prog_name="python -m tumble")
