"""`python -m unghost.cli`, for where the `unghost` script is not on the path."""

from unghost.cli.program import main

main()
