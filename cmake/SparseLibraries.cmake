# SuiteSparse and the BLAS under it, as the target substep_sparse; what is not there is named in
# sparse_missing, and SUBSTEP_BLAS is empty when there is no BLAS.
#
# The BLAS is the serial OpenBLAS wherever it is installed: its bits do not depend on any number of
# threads, and it starts none. Debian and Ubuntu keep the flavours of OpenBLAS in a folder each, all
# with the SONAMEs libblas.so.3 and liblapack.so.3, and `update-alternatives` chooses the one that
# libcholmod finds. We link both by name with a RUNPATH to the serial folder: the loader maps the
# libraries that our module names before those that libcholmod names, so that libcholmod gets ours.

set(multiarch ${CMAKE_SYSTEM_PROCESSOR}-linux-gnu)
set(sparse_names cholmod klu amd colamd suitesparseconfig)
if(SUBSTEP_GPL)
  list(APPEND sparse_names umfpack)
endif()
find_path(SUITESPARSE_INCLUDE cholmod.h PATH_SUFFIXES suitesparse)
set(sparse_missing "")
if(NOT SUITESPARSE_INCLUDE)
  list(APPEND sparse_missing cholmod.h)
endif()
set(sparse_libraries "")
foreach(name IN LISTS sparse_names)
  find_library(SUITESPARSE_${name} ${name} PATH_SUFFIXES ${multiarch})
  if(SUITESPARSE_${name})
    list(APPEND sparse_libraries ${SUITESPARSE_${name}})
  else()
    list(APPEND sparse_missing ${name})
  endif()
endforeach()
list(JOIN sparse_missing ", " sparse_missing)

set(serial_folder /usr/lib/${multiarch}/openblas-serial)
find_library(SUBSTEP_BLAS NAMES libblas.so.3 PATHS ${serial_folder} NO_DEFAULT_PATH)
find_library(SUBSTEP_LAPACK NAMES liblapack.so.3 PATHS ${serial_folder} NO_DEFAULT_PATH)
if(NOT SUBSTEP_BLAS)  # elsewhere: whatever OpenBLAS there is, which holds LAPACK too
  find_library(SUBSTEP_BLAS NAMES openblas PATH_SUFFIXES ${multiarch})
  set(SUBSTEP_LAPACK "")
endif()

add_library(substep_sparse INTERFACE)
target_include_directories(substep_sparse SYSTEM INTERFACE ${SUITESPARSE_INCLUDE})
# gomp is libcholmod's; we link it to keep its parallel regions serial
# (linalg/direct/library_calls.h).
target_link_libraries(substep_sparse INTERFACE
  -Wl,--push-state,--no-as-needed ${SUBSTEP_BLAS} ${SUBSTEP_LAPACK} -Wl,--pop-state
  ${sparse_libraries} gomp ${CMAKE_DL_LIBS})
# In a program, too, OpenBLAS and METIS find our definitions first (linalg/direct/blas_buffers.h).
target_link_options(substep_sparse INTERFACE $<$<STREQUAL:$<TARGET_PROPERTY:TYPE>,EXECUTABLE>:
  LINKER:--export-dynamic-symbol=blas_memory_*,--export-dynamic-symbol=gk_rand*>)
