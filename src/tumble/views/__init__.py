"""What is shown of a result, put together once: blocks, which `render` shows on a terminal, in a notebook, as HTML and
as PDF.

    blocks       sentences, tables, names with what they are, pictures
    numbers      one choice of units, one formatting of a value with its uncertainty
    render/      terminal, notebook, pages (HTML, PDF), data (how JSON is written), pictures (files)
    calibration, readings, inspection, checks, noise, planning, campaign, registry, sheet
                 the blocks, the content as JSON and the pictures of each kind of result
    registry_lists, control_chart, chart_panel
                 lists of the registry, the page of a device over its calibrations
    report/      the document that a laboratory signs
"""
