"""Reports: what a calibration found and what it rests on, as a document that a laboratory signs.

    calibration files → content (sections of blocks: plain text, numbers, pictures) → page (HTML) or pdf (PDF/A)

The content is put together once; the templates only show it. Needs the extra `tumble[report]`.

    blocks       what a document is made of
    content      the order of the sections
    result       parameters, how to apply them, frame, correlations, iterations
    recording    site, rests and turns against the programme, residuals, noise
    limits       acceptance limits and verdict
    compare      several calibrations of one device
    figures      plots, drawings: sphere and frame
    characters   text from files made harmless and visible
    page, pdf    the outputs
    write        from files to a file
"""
