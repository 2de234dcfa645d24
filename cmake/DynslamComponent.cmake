# Rooms. A room is a component of the package, a target, a directory under include/, src/,
# tests/ and benchmarks/, and a page under docs/components/, all of one name.

include_guard(DIRECTORY)

set(dynslam_middle_floor
    attention segmentation features matching geometry factors loop dataset evaluation)
set(dynslam_all_rooms core ${dynslam_middle_floor} slam)

# The rooms that have landed in this tree, ground floor first.
function(dynslam_present_rooms result)
  set(present "")
  foreach(room IN LISTS dynslam_all_rooms)
    if(EXISTS "${PROJECT_SOURCE_DIR}/src/${room}/CMakeLists.txt")
      list(APPEND present ${room})
    endif()
  endforeach()
  set(${result} "${present}" PARENT_SCOPE)
endfunction()

# The rooms that this build has, in the order in which they were configured.
function(dynslam_enabled_rooms result)
  get_property(rooms GLOBAL PROPERTY DYNSLAM_ENABLED_ROOMS)
  set(${result} "${rooms}" PARENT_SCOPE)
endfunction()

# dynslam_configure_rooms(all | <room>...)
function(dynslam_configure_rooms)
  dynslam_present_rooms(present)
  set(wanted ${ARGN})
  if("all" IN_LIST wanted OR NOT wanted)
    set(wanted ${present})
  endif()
  foreach(room IN LISTS wanted)
    if(NOT room IN_LIST dynslam_all_rooms)
      list(JOIN dynslam_all_rooms ", " names)
      message(FATAL_ERROR
        "DYNSLAM_COMPONENTS: dynslam has no component \"${room}\".\n  There are: ${names}")
    elseif(NOT room IN_LIST present)
      list(JOIN present ", " names)
      message(FATAL_ERROR "DYNSLAM_COMPONENTS: the component \"${room}\" is not in this "
        "source tree (no src/${room}/CMakeLists.txt).\n  There are: ${names}")
    endif()
  endforeach()
  set_property(GLOBAL PROPERTY DYNSLAM_ENABLED_ROOMS "")
  foreach(room IN LISTS present)
    if(room IN_LIST wanted)
      dynslam_configure_room(${room})
    endif()
  endforeach()
  dynslam_enabled_rooms(enabled)
  list(JOIN enabled ", " names)
  message(STATUS "dynslam ${PROJECT_VERSION}: ${names}")
endfunction()

# Configures a room unless that has happened already, whoever asks for it first.
function(dynslam_configure_room room)
  if(NOT TARGET dynslam_${room})
    add_subdirectory("${PROJECT_SOURCE_DIR}/src/${room}" "${PROJECT_BINARY_DIR}/src/${room}")
  endif()
  if(NOT TARGET dynslam_${room})
    message(FATAL_ERROR
      "src/${room}/CMakeLists.txt does not call dynslam_add_component(${room} ...)")
  endif()
endfunction()

# dynslam_add_component(<room>
#   [HEADER_ONLY]                     headers and nothing to compile
#   [SOURCES <file>...]               relative to src/<room>
#   [DEPENDS <room>...]               rooms below this one
#   [PACKAGES "<name> [arguments]"..] packages that the room and its users must find
#   [BUILD_PACKAGES "<name> ..."...]  packages that only building the room needs
#   [LINK_PUBLIC <target>...]         what the room's headers need
#   [LINK_PRIVATE <target>...]        what only its sources need
#   [PRECOMPILE <header>...]          what most of its sources or headers read first, see
#                                     DynslamTargets.cmake
#   [HEADER_CHECK_EXCLUDE <file>...]  relative to include/dynslam/<room>
#   [HEADER_CHECK_LINK <target>...]   what the headers need that the room does not link)
#
# Makes the target dynslam_<room>, also known as dynslam::<room>, its install rules and its
# fragment of the package. The room's CMakeLists.txt may go on to work on the target.
#
# PACKAGES also holds what a static library links privately, because whoever links the library
# links that too.
function(dynslam_add_component room)
  cmake_parse_arguments(PARSE_ARGV 1 arg "HEADER_ONLY" ""
    "SOURCES;DEPENDS;PACKAGES;BUILD_PACKAGES;LINK_PUBLIC;LINK_PRIVATE;PRECOMPILE;HEADER_CHECK_EXCLUDE;HEADER_CHECK_LINK")
  set(where "dynslam_add_component(${room})")
  if(arg_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "${where}: do not know what to do with \"${arg_UNPARSED_ARGUMENTS}\"")
  endif()
  if(NOT room IN_LIST dynslam_all_rooms)
    message(FATAL_ERROR "${where}: the house has no such room; see cmake/DynslamComponent.cmake")
  endif()
  if(arg_HEADER_ONLY AND (arg_SOURCES OR arg_LINK_PRIVATE))
    message(FATAL_ERROR "${where}: HEADER_ONLY goes without SOURCES and LINK_PRIVATE")
  elseif(NOT arg_HEADER_ONLY AND NOT arg_SOURCES)
    message(FATAL_ERROR "${where}: give SOURCES or HEADER_ONLY")
  endif()
  dynslam_check_arrows(${room} ${arg_DEPENDS})
  if(PROJECT_IS_TOP_LEVEL AND DYNSLAM_BUILD_TESTS)
    dynslam_check_furniture(${room})
  endif()

  foreach(below IN LISTS arg_DEPENDS)
    dynslam_configure_room(${below})
  endforeach()
  foreach(spec IN LISTS arg_PACKAGES arg_BUILD_PACKAGES)
    dynslam_find_package("${spec}" FOR "The component ${room} of dynslam")
  endforeach()

  set(target dynslam_${room})
  set(rooms_below ${arg_DEPENDS})
  list(TRANSFORM rooms_below PREPEND "dynslam::")
  if(arg_HEADER_ONLY)
    add_library(${target} INTERFACE)
    set(visible INTERFACE)
  else()
    add_library(${target} ${arg_SOURCES})
    set(visible PUBLIC)
    dynslam_apply_build_flags(${target})
    dynslam_precompile_headers(${target} ${arg_PRECOMPILE})
    if(DYNSLAM_JOIN_LIBRARIES)
      dynslam_join_sources(${target})
    endif()
    set_target_properties(${target} PROPERTIES
      VERSION "${PROJECT_VERSION}"
      SOVERSION "${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR}"
      INSTALL_RPATH "$ORIGIN")
    target_link_libraries(${target} PRIVATE ${arg_LINK_PRIVATE})
    target_include_directories(${target} PRIVATE "${PROJECT_SOURCE_DIR}/src")
  endif()
  add_library(dynslam::${room} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${room})
  target_compile_features(${target} ${visible} cxx_std_17)
  target_include_directories(${target} ${visible}
    "$<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include>"
    "$<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>")
  target_link_libraries(${target} ${visible} ${rooms_below} ${arg_LINK_PUBLIC})

  set_property(GLOBAL APPEND PROPERTY DYNSLAM_ENABLED_ROOMS ${room})
  foreach(name IN ITEMS DEPENDS PACKAGES PRECOMPILE HEADER_CHECK_EXCLUDE HEADER_CHECK_LINK)
    set_property(GLOBAL PROPERTY DYNSLAM_${room}_${name} "${arg_${name}}")
  endforeach()
  if(DYNSLAM_INSTALL)
    dynslam_install_room(${room})
  endif()
endfunction()

# Arrows go down only: the middle floor stands on core, slam may stand on everything.
function(dynslam_check_arrows room)
  foreach(below IN LISTS ARGN)
    if(NOT below IN_LIST dynslam_all_rooms)
      message(FATAL_ERROR "${room} depends on \"${below}\", which is not a room of dynslam")
    elseif(room STREQUAL "core")
      message(FATAL_ERROR "core is the ground floor, it cannot depend on ${below}")
    elseif(below STREQUAL "slam" OR (room IN_LIST dynslam_middle_floor
                                     AND NOT below STREQUAL "core"))
      message(FATAL_ERROR "${room} cannot depend on ${below}: rooms of the middle floor depend "
        "on core alone. What both of them need belongs in core.")
    endif()
    if(NOT EXISTS "${PROJECT_SOURCE_DIR}/src/${below}/CMakeLists.txt")
      message(FATAL_ERROR "${room} depends on ${below}, which is not in this source tree")
    endif()
  endforeach()
endfunction()

# A room without tests, a page and an example is not finished and is not let in.
function(dynslam_check_furniture room)
  set(missing "")
  file(GLOB tests CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/tests/${room}/*_test.cpp")
  if(NOT tests)
    string(APPEND missing "\n  tests:    tests/${room}/*_test.cpp")
  endif()
  if(NOT EXISTS "${PROJECT_SOURCE_DIR}/docs/components/${room}.md")
    string(APPEND missing "\n  page:     docs/components/${room}.md")
  endif()
  file(GLOB examples CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/examples/*_${room}*.cpp")
  if(NOT examples)
    string(APPEND missing "\n  example:  examples/NN_${room}_<topic>.cpp")
  endif()
  if(missing)
    message(FATAL_ERROR "The component ${room} is not complete. Missing:${missing}\n"
      "A build without tests, -DDYNSLAM_BUILD_TESTS=OFF, does not ask for these.")
  endif()
endfunction()

# ---------------------------------------------------------------------------------------------
# Install rules and package
# ---------------------------------------------------------------------------------------------
set(dynslam_package_dir "${CMAKE_INSTALL_LIBDIR}/cmake/dynslam")

function(dynslam_install_room room)
  install(TARGETS dynslam_${room} EXPORT dynslam-${room}
    ARCHIVE DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT ${room}
    LIBRARY DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT ${room}
    RUNTIME DESTINATION "${CMAKE_INSTALL_BINDIR}" COMPONENT ${room})
  install(DIRECTORY "${PROJECT_SOURCE_DIR}/include/dynslam/${room}"
    DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}/dynslam" COMPONENT ${room}
    FILES_MATCHING PATTERN "*.hpp" PATTERN "*.h" PATTERN "*.inc")
  install(EXPORT dynslam-${room} NAMESPACE dynslam:: FILE dynslam-${room}-targets.cmake
    DESTINATION "${dynslam_package_dir}" COMPONENT ${room})

  get_property(depends GLOBAL PROPERTY DYNSLAM_${room}_DEPENDS)
  get_property(packages GLOBAL PROPERTY DYNSLAM_${room}_PACKAGES)
  set(content "# What dynslam::${room} needs. Generated; read by dynslam-config.cmake.\n")
  string(APPEND content "set(dynslam_${room}_DEPENDS \"${depends}\")\n")
  foreach(spec IN LISTS packages)
    string(REGEX MATCH "^[^ ]+" name "${spec}")
    string(APPEND content "dynslam_find_dependency(${room} "
      "\"${dynslam_debian_package_${name}}\" ${spec})\n")
  endforeach()
  set(file "${PROJECT_BINARY_DIR}/package/dynslam-${room}-dependencies.cmake")
  file(GENERATE OUTPUT "${file}" CONTENT "${content}")
  install(FILES "${file}" DESTINATION "${dynslam_package_dir}" COMPONENT ${room})
endfunction()

function(dynslam_install_package)
  include(CMakePackageConfigHelpers)
  set(DYNSLAM_KNOWN_ROOMS "${dynslam_all_rooms}")
  configure_package_config_file("${PROJECT_SOURCE_DIR}/cmake/dynslam-config.cmake.in"
    "${PROJECT_BINARY_DIR}/package/dynslam-config.cmake"
    INSTALL_DESTINATION "${dynslam_package_dir}"
    NO_SET_AND_CHECK_MACRO NO_CHECK_REQUIRED_COMPONENTS_MACRO)
  write_basic_package_version_file("${PROJECT_BINARY_DIR}/package/dynslam-config-version.cmake"
    VERSION "${PROJECT_VERSION}" COMPATIBILITY SameMinorVersion)
  install(FILES
    "${PROJECT_BINARY_DIR}/package/dynslam-config.cmake"
    "${PROJECT_BINARY_DIR}/package/dynslam-config-version.cmake"
    "${PROJECT_SOURCE_DIR}/cmake/FindDynslamOnnxRuntime.cmake"
    DESTINATION "${dynslam_package_dir}" COMPONENT core)
  install(FILES "${PROJECT_SOURCE_DIR}/LICENSE"
    DESTINATION "${CMAKE_INSTALL_DATAROOTDIR}/doc/dynslam" COMPONENT core)
endfunction()
