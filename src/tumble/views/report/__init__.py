"""Reports: what a calibration found and what it rests on, as a document that a laboratory signs.

    calibration files → document (sections of blocks: plain text, numbers, pictures) → page (HTML) or pdf (PDF/A)

The content is put together once; the templates only show it. Needs the extra `tumble[report]`.

    document     the order of the sections
    result       parameters, how to apply them, frame, correlations, iterations
    recording    site, rests and turns against the programme, residuals, noise
    limits       acceptance limits and verdict
    compare      several calibrations of one device
    certified    what a certificate adds
    over_temperature, figures, drawings
                 plots; drawings: sphere and frame
    write        from files to a file
"""
