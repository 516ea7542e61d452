"""The command line of uavaou: one module a command, which parses, calls the library and prints."""
