"""``python -m viewshed``: the command line where no program ``viewshed`` is on the path."""

from viewshed.cli import main

if __name__ == "__main__":
    main()
