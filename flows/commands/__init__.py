"""Commands of the command line: each module adds its parser and runs it; what is slow to import it imports when run."""
