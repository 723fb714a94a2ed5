/* A closed loop as one would write it by hand for one plant and one law: measure, decide, hold. In the place of
 * the compiled engine's loop.c; FMI 2.0, all outputs measured in their order, one controlled output, no noise. */
#include "controller.h"
#include "loop.h"

#include <string.h>

typedef int (*SetReal)(void *, const uint32_t *, size_t, const double *);
typedef int (*GetReal)(void *, const uint32_t *, size_t, double *);
typedef int (*DoStep)(void *, double, double, int);

int64_t loop_run(const Loop *loop, Progress *progress)
{
    const PlantCalls *plant = &loop->plant;
    const SetReal set = (SetReal)plant->set_values;
    const GetReal get = (GetReal)plant->get_values;
    const DoStep step = (DoStep)plant->do_step;
    const size_t n = (size_t)plant->n_outputs, m = (size_t)loop->m;
    double *const y = loop->plant_outputs;
    for (int64_t row = loop->begin; row < loop->end; ++row) {
        double *const u = loop->u + (size_t)row * m;
        loop->y[row] = y[0];
        memcpy(loop->measurements + (size_t)row * n, y, n * sizeof(double));
        if (loop->commands) memcpy(u, loop->commands + (size_t)row * m, m * sizeof(double));
        else loop->status[row] = controller_step(loop->controller, y, loop->reference + row, u);
        if (loop->seen) loop->seen[row] = y[0];
        progress->rows = row + 1;
        if (row + 1 == loop->end && !loop->holds_last) break;
        if (set(plant->instance, plant->inputs, m, u)
            || step(plant->instance, plant->base_time + (double)row * plant->step_size, plant->step_size, 1)
            || get(plant->instance, plant->outputs, n, y))
            return LOOP_PLANT_FAILED;
        progress->steps = row + 1;
    }
    return LOOP_DONE;
}

size_t loop_controller_size(void) { return sizeof(ControllerState); }

void loop_start_controller(void *state, const double numbers[])
{
#ifdef CONTROLLER_LOADS
    controller_load(numbers);
#else
    (void)numbers;
#endif
    controller_start(state);
}
