"""Files of any size: frames filtered in bands of rows, from file to file, to the same bits as a whole."""
