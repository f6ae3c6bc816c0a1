"""Which law the numbers follow: polynomial, ARMAX and NARMAX identification; knows no robot."""
