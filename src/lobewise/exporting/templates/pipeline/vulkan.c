extern void *halide_vulkan_get_symbol(void *context, const char *name);
extern void halide_vulkan_set_alloc_config(const char *config);

/* Whether Vulkan has a device. Halide's runtime ends the program where there is none. */
static int has_vulkan(void)
{
    /* VkInstanceCreateInfo (Vulkan 1.3, section 4.2): its type is 1, all else may be 0. */
    struct {
        int32_t type;
        const void *next;
        uint32_t flags;
        const void *application;
        uint32_t layers;
        const void *layer_names;
        uint32_t extensions;
        const void *extension_names;
    } info = {1, NULL, 0, NULL, 0, NULL, 0, NULL};
    int32_t (*create)(const void *, const void *, void **) = NULL;
    int32_t (*list)(void *, uint32_t *, void *) = NULL;
    void (*destroy)(void *, const void *) = NULL;
    void *symbol, *instance = NULL;
    uint32_t count = 0;
    symbol = halide_vulkan_get_symbol(NULL, "vkCreateInstance");
    memcpy(&create, &symbol, sizeof symbol);
    symbol = halide_vulkan_get_symbol(NULL, "vkEnumeratePhysicalDevices");
    memcpy(&list, &symbol, sizeof symbol);
    symbol = halide_vulkan_get_symbol(NULL, "vkDestroyInstance");
    memcpy(&destroy, &symbol, sizeof symbol);
    if (!create || !list || !destroy || create(&info, NULL, &instance) != 0) {
        return 0;
    }
    list(instance, &count, NULL);
    destroy(instance, NULL);
    return count > 0;
}

