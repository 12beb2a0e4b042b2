// Work space for OpenBLAS that belongs to a thread.
//
// Every matrix product of OpenBLAS takes a buffer from a table of the library by blas_memory_alloc.
// Its serial build keeps no lock on that table, so that two threads can be given one buffer, and
// where no memory is left it asks for ever. Both end here: we define blas_memory_alloc and
// blas_memory_free, and the loader prefers the definition of the module that it was asked to load
// to those of the libraries below it.
#pragma once

namespace substep {

// Makes sure that this thread has a buffer; throws std::bad_alloc.
void reserve_blas_buffer();

// Whether OpenBLAS does take its buffers from us, so that several threads may be inside it. False
// where another module of the process had loaded it before.
bool blas_is_reentrant();

}  // namespace substep
