"""Client and command line of Unghost."""
