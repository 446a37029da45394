"""What runs have ended with.

- `found`: the end of one run: its files, its last figures in the log, and what is printed.
- `finished`: finished runs below a folder, and which plate each is of.
- `gathered`: their searches put together, over runs and seeds.
- `table`: how tables stand on a terminal.
"""
