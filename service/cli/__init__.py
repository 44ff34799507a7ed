"""The command line: commands, tables and progress bars on a terminal."""
