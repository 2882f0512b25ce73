"""Train, validate, test or export a network: `palpate train` in a checkout."""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from palpate.cli.train import main

if __name__ == "__main__":
    run_door(main)
