"""The cheapest way of an instrument's tip past tissue that gives way: `palpate plan` in a checkout."""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from palpate.command.plan import main

if __name__ == "__main__":
    run_door(main)
