"""``python -m viewshed``: the command line, if the program ``viewshed`` is not on the path."""

from viewshed.cli import main

if __name__ == "__main__":
    main()
