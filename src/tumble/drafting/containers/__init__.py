"""Files that hold logs: archives, workbooks, documents of JSON, rows of several sensors. Each becomes files of its own
in the session's folder."""
