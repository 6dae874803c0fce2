"""`python -m rbtrg_robot.cli` is `rbtrg-robot`."""

from rbtrg_robot.cli.entry import main

if __name__ == "__main__":
    main()
