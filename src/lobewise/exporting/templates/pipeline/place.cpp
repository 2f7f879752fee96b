            frame.row = static_cast<int>(view[13]);
            frame.column = static_cast<int>(view[14]);
            const std::size_t samples = static_cast<std::size_t>(((height - frame.row + ${last}) / ${scale}) *
                                                                 ((width - frame.column + ${last}) / ${scale}));
