"""Views of results: blocks of text, tables and figures, which `render` shows on a terminal, in a notebook and as pages.

Each module builds the blocks of one kind of result; `report/` builds the document of one or several calibrations.
`--json` prints the result itself, by `documents.as_json`.
"""
