    int row, column; /* which pixel of each block of ${scale} x ${scale} was shaded, 0 to ${last}; sample
                        (Y, X) was shaded at pixel (Y scale + row, X scale + column); rows is
                        ceil((height - row) / ${scale}), and columns likewise */
