"""Reports: what a calibration found and what it rests on, as one page of HTML that needs nothing else and prints well.

    calibration files → document (sections of blocks: plain text, numbers, pictures) → page

Needs the extra `tumble[lab]`. What a laboratory adds, limits and certificates, is in `tumble.lab.report`.

    document     from files to a file; the order of the sections, the first page
    result       verdict, parameters, launches, several calibrations, correlations
    application  how to apply it: frame, matrices, the whole correction, test vectors
    recording    rests and turns against the programme, residuals, noise
    over_temperature, figures
                 the section on temperature; the sphere and the residuals
"""
