"""Reports: what a calibration found and what it rests on, as a document that a laboratory signs.

    calibration files → document (sections of blocks: plain text, numbers, pictures) → page (HTML) or pdf (PDF/A)

The content is put together once; the templates only show it. Needs the extra `tumble[lab]`.

    document     the order of the sections, the first page, what a certificate adds
    result       parameters, limits, several calibrations, correlations, iterations
    application  how to apply it: matrices, the whole correction, test vectors, the frame
    recording    site, rests and turns against the programme, residuals, noise
    over_temperature, figures, drawings
                 plots; drawings: sphere and frame
    write        from files to a file
"""
