"""The forms of a report: `markdown`, one HTML `page` and how it looks (`page_style`), tables in `latex`."""
