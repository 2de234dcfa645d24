// How a layer borrows the caller's threads.
#pragma once

#include <memory>
#include <type_traits>
#include <utility>

namespace dynslam::attention {

/// A task of a layer, called with its index. Refers to a function that lives until the executor
/// returns; copying it is free. Tasks do not throw and do not wait for one another.
class Task {
 public:
  using Function = void (*)(const void* context, int index);
  Task(Function function, const void* context) : function_(function), context_(context) {}
  void operator()(int index) const { function_(context_, index); }

 private:
  Function function_;
  const void* context_;
};

/// Reference to the caller's means of running tasks at once; the default runs them in the calling
/// thread, one after another.
///
///     auto run = [&](int count, attention::Task task) { pool.parallel_for(count, task); };
///     layer.run(input, output, workspace, attention::Executor(run, pool.size()));
///
/// `run(count, task)` must call task(0) ... task(count - 1) once each, in any order and on any
/// threads, and return when all are done. `tasks` is the number of pieces that work is cut into,
/// and so the number of threads that can be busy; the workspace grows with it. Results do not
/// depend on it, bit for bit. `run` is referred to, not copied: it has to outlive the call.
class Executor {
 public:
  Executor() = default;

  template <typename Run, typename = std::enable_if_t<std::is_invocable_v<Run&, int, Task>>>
  Executor(Run& run, int tasks)
      : object_(const_cast<void*>(static_cast<const void*>(std::addressof(run)))),
        call_([](void* object, int count, Task task) {
          (*static_cast<std::remove_reference_t<Run>*>(object))(count, task);
        }),
        tasks_(tasks < 1 ? 1 : tasks) {}

  int tasks() const { return tasks_; }

  /// body(i) for i in [0, count).
  template <typename Body>
  void run(int count, const Body& body) const {
    if (call_ == nullptr || count <= 1) {
      for (int i = 0; i < count; ++i) body(i);
      return;
    }
    call_(object_, count,
          Task([](const void* context, int index) { (*static_cast<const Body*>(context))(index); },
               std::addressof(body)));
  }

 private:
  void* object_ = nullptr;
  void (*call_)(void*, int, Task) = nullptr;
  int tasks_ = 1;
};

}  // namespace dynslam::attention
