# The package ${name}: find_package(${name} CONFIG REQUIRED PATHS <this folder>) gives the target ${name}::${name}.
# It compiles the driver with the project's own compiler and links the compiled kernels beside it.
if(TARGET ${name}::${name})
    return()
endif()
enable_language(C)
get_filename_component(_${name}_folder "${CMAKE_CURRENT_LIST_FILE}" PATH)
find_package(Threads REQUIRED)
add_library(${name} STATIC "$${_${name}_folder}/${name}.c")
add_library(${name}::${name} ALIAS ${name})
set_target_properties(${name} PROPERTIES C_STANDARD 99 POSITION_INDEPENDENT_CODE ON)
target_include_directories(${name} PUBLIC "$${_${name}_folder}")
target_link_libraries(${name} PUBLIC
${objects}
    Threads::Threads $${CMAKE_DL_LIBS})${link_options}
if(UNIX)
    target_link_libraries(${name} PUBLIC m)
endif()
