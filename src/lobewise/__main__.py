"""`python -m lobewise`: the program `lobewise`, where its folder is not on the PATH."""

from lobewise.cli import main

if __name__ == "__main__":
    main()
