"""What is shown of a result, put together once: blocks, which `render` shows on a terminal, in a notebook and as pages.

    blocks       sentences, tables, names with what they are, pictures
    numbers      one choice of units, one formatting of a value with its uncertainty, one table of quantities
    render/      terminal, pages (HTML, PDF), pictures
    calibration, readings, inspection, checks, noise, planning, campaign, sheet, uncertainty_budget
                 the blocks and the pictures of each kind of result
    report/      the document of one or several calibrations

`--json` needs none of this: `documents.as_json` prints the result itself.
"""
