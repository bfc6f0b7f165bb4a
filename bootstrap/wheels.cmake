# How ssp_msgs is built on the PyPI wheels of ROS: read at the end of project(). On a machine with a
# ROS distribution this file is not used.

# SSP's nodes are Python on Fast DDS. The C++ messages would be half of the build, and nothing here
# loads them. The introspection type support in C stays: rmw_fastrtps makes type objects with it, and
# without it no subscription can be created.
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators QUIET)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# The wheels export targets whose include folder is one of the machine that built them
# (/opt/python/...). CMake refuses a folder that does not exist, so it is taken out of the imported
# targets once the top directory has been read.
function(ssp_drop_missing_include_dirs)
  get_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(dirs ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT dirs)
      continue()
    endif()
    set(kept "")
    foreach(dir IN LISTS dirs)
      if(dir MATCHES "^\\$<" OR EXISTS "${dir}")
        list(APPEND kept "${dir}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()

cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL ssp_drop_missing_include_dirs)
