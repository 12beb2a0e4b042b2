#include "owner.h"

#include <pthread.h>

#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "bindings.h"
#include "substep/core/errors.h"
// After Python.h:
#include <structmember.h>

namespace {

thread_local int user_functions = 0;  // that this thread is in
int forks = 0;                        // between the first process and this one

class Turn;

// Of an object, or of several that share obstacles. With the GIL, as all here.
struct Use {
  unsigned long thread = 0;       // whose calls they are, 0: nobody's
  int calls = 0;                  // one within the other
  int functions = 0;              // of the user's, that the thread was in when it came
  int steps = 0;                  // of those calls, how many take steps
  int forks = 0;                  // before the first of them
  std::shared_ptr<Use> together;  // what has taken its place
  Turn* first = nullptr;          // of those that wait for it, who came first
  int queued_forks = 0;           // before they came
};

// In which queue a call waits; it leaves it when it ends, whatever ends it.
class Turn {
 public:
  Turn() = default;
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() { leave(); }

  // Whether nobody else has come before.
  bool is_next(Use& use) const {
    forget_left_behind(use);
    return use.first == nullptr || use.first == this;
  }
  void wait_for(const std::shared_ptr<Use>& use) {
    if (use == use_) return;
    leave();
    forget_left_behind(*use);
    *find(*use, nullptr) = this;
    use_ = use;
  }

 private:
  // Threads that fork() left behind never come.
  static void forget_left_behind(Use& use) {
    if (use.queued_forks != forks) use.first = nullptr;
    use.queued_forks = forks;
  }
  static Turn** find(Use& use, const Turn* turn) {
    Turn** at = &use.first;
    while (*at != nullptr && *at != turn) at = &(*at)->next_;
    return at;
  }
  void leave() {
    if (!use_) return;
    Turn** const at = find(*use_, this);
    if (*at == this) *at = next_;
    next_ = nullptr;
    use_.reset();
  }

  std::shared_ptr<Use> use_;
  Turn* next_ = nullptr;
};

// Native, because Python runs handlers of signals between its own instructions: a KeyboardInterrupt
// between the taking and the `with` that lets go would leave an object taken for good.
class Owner {
 public:
  explicit Owner(std::string name) : name_(std::move(name)) {}

  bool taken() { return use().thread != 0; }

  // Waits for short calls of other threads, and for those that wait already, so that one that calls
  // again and again lets others in; refuses while they take steps.
  void enter() {
    const unsigned long self = PyThread_get_thread_ident();
    Turn turn;
    while (use().thread != self && !(use().thread == 0 && turn.is_next(use()))) {
      if (use().thread != 0 && use().forks != forks) {
        refuse("in use by another thread, which fork() left behind");
      }
      if (use().steps > 0) {
        refuse("in use by another thread: wait for its call, or have its callback hand out copies");
      }
      turn.wait_for(find());
      wait();
    }
    Use& now = use();
    if (now.calls > 0 && user_functions > now.functions) {
      refuse("in the middle of a step, whose functions cannot use it");
    }
    if (now.calls++ == 0) {
      now.thread = self;
      now.functions = user_functions;
      now.forks = forks;
    }
  }

  // The call that has entered last takes steps; those of another are not within it.
  void begin(const char* method) {
    if (step_ > 0) {
      throw substep::InputError(std::string(method) +
                                ": called by the callback of advance, which may do all but step");
    }
    step_ = use().calls;
    ++use().steps;
  }

  void leave() {
    Use& now = use();
    if (step_ == now.calls) {
      step_ = 0;
      --now.steps;
    }
    if (--now.calls == 0) now.thread = 0;
  }

  // From now on who uses the one uses the other.
  void join(Owner& other) {
    other.enter();  // so it is free, or this thread's
    other.leave();
    const std::shared_ptr<Use> mine = find(), theirs = other.find();
    if (mine == theirs) return;
    if (mine->calls > 0 && theirs->calls > 0) other.refuse("in use by two simulations");
    if (theirs->calls > 0) {
      mine->together = theirs;
    } else {
      theirs->together = mine;
    }
  }

 private:
  const std::shared_ptr<Use>& find() {
    while (use_->together) use_ = use_->together;
    return use_;
  }
  Use& use() { return *find(); }

  [[noreturn]] void refuse(const char* why) const {
    throw substep::InputError("this " + name_ + " is " + why);
  }

  static void wait() {
    {
      const py::gil_scoped_release released;
      std::this_thread::sleep_for(std::chrono::microseconds(20));
    }
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
  }

  std::string name_;
  std::shared_ptr<Use> use_ = std::make_shared<Use>();
  int step_ = 0;  // which of the calls takes steps of this object
};

// A method of objects that have an `_owner`: a call takes them for as long as it runs. A type of
// CPython's, for its cost; functools.update_wrapper() makes it look like its function.
struct Alone {
  PyObject_HEAD vectorcallfunc vectorcall;
  PyObject *function, *attributes;
};

void tell(const substep::InputError& error) {
  py::set_error(py::module_::import("substep.errors").attr("InputError"), error.what());
}

PyObject* call_alone(PyObject* self, PyObject* const* arguments, std::size_t count,
                     PyObject* names) {
  PyObject* const function = reinterpret_cast<Alone*>(self)->function;
  if (PyVectorcall_NARGS(count) == 0)  // says so
    return PyObject_Vectorcall(function, arguments, count, names);
  static PyObject* const name = PyUnicode_InternFromString("_owner");
  const auto holder = py::reinterpret_steal<py::object>(PyObject_GetAttr(arguments[0], name));
  if (!holder) return nullptr;
  try {
    auto& owner = holder.cast<Owner&>();
    owner.enter();
    PyObject* const answer = PyObject_Vectorcall(function, arguments, count, names);
    owner.leave();
    return answer;
  } catch (const substep::InputError& error) {
    tell(error);
  } catch (py::error_already_set& error) {
    error.restore();
  } catch (const py::cast_error&) {
    PyErr_SetString(PyExc_TypeError, "_owner: expected an Owner");
  }
  return nullptr;
}

PyObject* bind_alone(PyObject* self, PyObject* object, PyObject*) {
  return object == nullptr ? Py_NewRef(self) : PyMethod_New(self, object);
}

int visit_alone(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  Py_VISIT(reinterpret_cast<Alone*>(self)->function);
  Py_VISIT(reinterpret_cast<Alone*>(self)->attributes);
  return 0;
}

int clear_alone(PyObject* self) {
  Py_CLEAR(reinterpret_cast<Alone*>(self)->function);
  Py_CLEAR(reinterpret_cast<Alone*>(self)->attributes);
  return 0;
}

void free_alone(PyObject* self) {
  PyObject_GC_UnTrack(self);
  clear_alone(self);
  PyTypeObject* const type = Py_TYPE(self);
  type->tp_free(self);
  Py_DECREF(type);
}

py::object make_type_of_alone() {
  static PyMemberDef members[] = {
      {"__vectorcalloffset__", T_PYSSIZET, offsetof(Alone, vectorcall), READONLY, nullptr},
      {"__dictoffset__", T_PYSSIZET, offsetof(Alone, attributes), READONLY, nullptr},
      {nullptr, 0, 0, 0, nullptr}};
  static PyGetSetDef computed[] = {
      {"__dict__", &PyObject_GenericGetDict, &PyObject_GenericSetDict, nullptr, nullptr},
      {nullptr, nullptr, nullptr, nullptr, nullptr}};
  static PyType_Slot slots[] = {{Py_tp_call, reinterpret_cast<void*>(&PyVectorcall_Call)},
                                {Py_tp_descr_get, reinterpret_cast<void*>(&bind_alone)},
                                {Py_tp_traverse, reinterpret_cast<void*>(&visit_alone)},
                                {Py_tp_clear, reinterpret_cast<void*>(&clear_alone)},
                                {Py_tp_dealloc, reinterpret_cast<void*>(&free_alone)},
                                {Py_tp_members, members},
                                {Py_tp_getset, computed},
                                {0, nullptr}};
  static PyType_Spec spec{"substep._core.Alone", sizeof(Alone), 0,
                          Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL |
                              Py_TPFLAGS_METHOD_DESCRIPTOR | Py_TPFLAGS_DISALLOW_INSTANTIATION,
                          slots};
  auto type = py::reinterpret_steal<py::object>(PyType_FromSpec(&spec));
  if (!type) throw py::error_already_set();
  return type;
}

py::object alone(const py::object& type, const py::object& function) {
  auto* const kind = reinterpret_cast<PyTypeObject*>(type.ptr());
  auto self = py::reinterpret_steal<py::object>(kind->tp_alloc(kind, 0));
  if (!self) throw py::error_already_set();
  auto* const one = reinterpret_cast<Alone*>(self.ptr());
  one->vectorcall = &call_alone;
  one->function = Py_NewRef(function.ptr());
  return self;
}

}  // namespace

InUserFunction::InUserFunction() { ++user_functions; }
InUserFunction::~InUserFunction() { --user_functions; }

void bind_owner(py::module_& m) {
  pthread_atfork(nullptr, nullptr, [] { ++forks; });
  py::class_<Owner>(m, "Owner")
      .def(py::init<std::string>(), py::arg("name"))
      .def_property_readonly("taken", &Owner::taken)
      .def("__enter__", &Owner::enter)
      .def("__exit__", [](Owner& self, py::handle, py::handle, py::handle) { self.leave(); })
      .def("begin", &Owner::begin, py::arg("method"))
      .def("join", &Owner::join, py::arg("other"));
  const py::object type = make_type_of_alone();
  m.def(
      "alone", [type](const py::object& function) { return alone(type, function); },
      py::arg("function"));
  m.def(
      "call_user",
      [](const py::object& function, const py::tuple& arguments) {
        const InUserFunction now;
        return py::object(function(*arguments));
      },
      py::arg("function"), py::arg("arguments"));
  // call(*arguments), and attributes.update(parts) after it: no handler of signals comes between.
  m.def(
      "commit",
      [](const py::dict& attributes, const py::dict& parts, const py::object& call,
         const py::tuple& arguments) {
        py::object answer = call(*arguments);
        if (PyDict_Update(attributes.ptr(), parts.ptr()) != 0) throw py::error_already_set();
        return answer;
      },
      py::arg("attributes"), py::arg("parts"), py::arg("call"), py::arg("arguments"));
}
