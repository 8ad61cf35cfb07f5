"""One module a command: HELP, EXAMPLE, configure(parser), run(args) -> exit code."""
