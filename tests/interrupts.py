"""Children of tests that Ctrl-C reaches."""

LISTEN = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""First line of a child's program. A shell that runs tests in the background ignores interrupts, and its children
inherit this."""
