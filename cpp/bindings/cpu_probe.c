/* Which x86-64 level this machine runs, found without executing anything above the baseline. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

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

static PyMethodDef methods[] = {{"level", level, METH_NOARGS, "Best x86-64 level of this machine."},
                                {NULL, NULL, 0, NULL}};
static struct PyModuleDef module = {.m_base = PyModuleDef_HEAD_INIT,
                                    .m_name = "_cpu",
                                    .m_size = -1,
                                    .m_methods = methods};

PyMODINIT_FUNC PyInit__cpu(void) { return PyModule_Create(&module); }
