/* Makes the state that a frame has written that of the frame before. */
static void swap_places(void **memory, int written, int before)
{
    void *const place = memory[written];
    memory[written] = memory[before];
    memory[before] = place;
}

