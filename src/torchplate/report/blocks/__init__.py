"""What a report is made of, whatever form it takes.

- `document`: its blocks.
- `numbers`: values with their errors; `channel_names`: what "3w" says.
"""
