"""For all tests."""

import signal

# A shell that starts the tests in the background has them, and all they start, ignore Ctrl-C, which some of them send.
signal.signal(signal.SIGINT, signal.default_int_handler)
