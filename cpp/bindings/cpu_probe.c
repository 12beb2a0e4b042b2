/* Which x86-64 level this machine runs, found without executing anything above the baseline, and
   which level this process holds. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <string.h>

static PyObject *level(PyObject *self, PyObject *unused) {
  (void)self;
  (void)unused;
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("x86-64-v4")) return PyUnicode_FromString("v4");
  if (__builtin_cpu_supports("x86-64-v3")) return PyUnicode_FromString("v3");
  if (__builtin_cpu_supports("x86-64-v2")) return PyUnicode_FromString("v2");
#endif
  return PyUnicode_FromString("baseline");
}

/* The first level to be claimed is the process's own: this memory outlives any module object. */
static char held[16];

static PyObject *claim(PyObject *self, PyObject *argument) {
  (void)self;
  Py_ssize_t size = 0;
  const char *wanted = PyUnicode_AsUTF8AndSize(argument, &size);
  if (!wanted) return NULL;
  if (!held[0] && size < (Py_ssize_t)sizeof held) memcpy(held, wanted, (size_t)size + 1);
  return PyUnicode_FromString(held);
}

static PyMethodDef methods[] = {
    {"level", level, METH_NOARGS, "Best x86-64 level of this machine."},
    {"claim", claim, METH_O, "Take a level for this process unless it has one; return its level."},
    {NULL, NULL, 0, NULL}};
static struct PyModuleDef module = {.m_base = PyModuleDef_HEAD_INIT,
                                    .m_name = "_cpu",
                                    .m_size = -1,
                                    .m_methods = methods};

PyMODINIT_FUNC PyInit__cpu(void) { return PyModule_Create(&module); }
