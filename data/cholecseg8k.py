"""`python -m data.cholecseg8k DIR`: prepares a CholecSeg8k folder (see `data.training.cholecseg8k`)."""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from palpate.data.training.cholecseg8k import main

if __name__ == "__main__":
    run_door(main, "Interrupted; what is prepared stays, and the same command goes on from there.")
