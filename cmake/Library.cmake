# The core for C++ programs (docs/cpp.md): its headers, a static library of one instruction level
# and a CMake package, find_package(substep) with the target substep::substep. SUBSTEP_LEVELS names
# the level: native (the default here) or, for other machines too, v2, v3 or v4.

list(LENGTH SUBSTEP_LEVELS levels)
if(NOT levels EQUAL 1)
  message(FATAL_ERROR " substep: a library has one instruction level, SUBSTEP_LEVELS names ${levels}")
endif()

add_library(substep STATIC
  $<TARGET_OBJECTS:objects_${SUBSTEP_LEVELS}> $<TARGET_OBJECTS:objects_once>)
target_compile_features(substep INTERFACE cxx_std_20)
target_link_libraries(substep INTERFACE Eigen3::Eigen Threads::Threads)
# Headers hold vectors of the level's width and matrices aligned to it, so that a program must be
# compiled for the same level; and the same formulas, so that it must not contract them.
target_compile_options(substep INTERFACE -ffp-contract=off -Wno-psabi)
target_compile_definitions(substep INTERFACE ${eigen_layout})
if(NOT SUBSTEP_LEVELS STREQUAL "baseline")
  target_compile_options(substep INTERFACE -march=x86-64-${SUBSTEP_LEVELS})
endif()

include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(package ${CMAKE_INSTALL_LIBDIR}/cmake/substep)
if(SKBUILD OR SUBSTEP_PYTHON)
  set(apart EXCLUDE_FROM_ALL)  # cmake --install DIRECTORY --component library
endif()
install(TARGETS substep EXPORT substep COMPONENT library ${apart}
  INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(DIRECTORY cpp/substep DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT library ${apart}
  FILES_MATCHING PATTERN *.h)
install(EXPORT substep NAMESPACE substep:: FILE targets.cmake DESTINATION ${package}
  COMPONENT library ${apart})
configure_package_config_file(cmake/package.cmake.in ${CMAKE_BINARY_DIR}/substep-config.cmake
  INSTALL_DESTINATION ${package} NO_SET_AND_CHECK_MACRO NO_CHECK_REQUIRED_COMPONENTS_MACRO)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/substep-config-version.cmake
  VERSION ${PROJECT_VERSION} COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/substep-config.cmake
  ${CMAKE_BINARY_DIR}/substep-config-version.cmake cmake/SparseLibraries.cmake
  DESTINATION ${package} COMPONENT library ${apart})
