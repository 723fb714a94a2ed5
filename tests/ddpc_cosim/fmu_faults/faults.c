#include "faults.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <io.h>
#define write _write
#else
#include <unistd.h>
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { MEGABYTES = 100, LINE = 1000, LINES = MEGABYTES * 1000 };

static volatile int always = 1;
static int *volatile nowhere = NULL;

/* Tell whoever reads the pipe of this name, and never return. */
static void hang(void) {
    const char *name = getenv("FAULT_PIPE");
    FILE *pipe = name ? fopen(name, "w") : NULL;
    if (pipe)
        fclose(pipe);
    while (always) {
    }
}

static int overflow_stack(volatile int depth) {
    volatile char frame[4096];
    frame[0] = (char)depth;
    return always ? overflow_stack(depth + 1) + frame[0] : 0;
}

static void make_line(char line[LINE + 1]) {
    memset(line, 'x', LINE);
    line[LINE - 1] = '\n';
    line[LINE] = '\0';
}

static void flood_stream(FILE *stream) {
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        fputs(line, stream);
    fflush(stream);
}

static void flood_descriptor(void) {
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        if (write(1, line, LINE) < 0)
            return;
}

static void flood_log(Model *model) {
    char line[LINE + 1];
    make_line(line);
    for (int i = 0; i < LINES; i++)
        model->log(model->environment, line);
}

static void leave_a_file(void) {
    char *name = tempnam(NULL, "left-");
    FILE *file = fopen(name, "w");
    if (file)
        fclose(file);
    free(name);
}

static int misbehave_in_step(Model *model) {
    switch (model->fault) {
    case RETURN_ERROR: return ERROR;
    case RETURN_FATAL: return FATAL;
    case RETURN_DISCARD: return DISCARD;
    case DISCARD_AND_TERMINATE: model->wants_termination = 1; return DISCARD;
    case RETURN_NAN: model->y = NAN; return OK;
    case RETURN_INFINITY: model->y = INFINITY; return OK;
    case SEGMENTATION_FAULT: *nowhere = 1; return OK;
    case CALL_ABORT: abort();
    case CALL_EXIT: exit(3);
    case OVERFLOW_STACK: return overflow_stack(0);
    case HANG_IN_STEP: hang(); return OK;
    case FLOOD_LOG: flood_log(model); return OK;
    case FLOOD_STDOUT: flood_stream(stdout); return OK;
    case FLOOD_STDERR: flood_stream(stderr); return OK;
    case FLOOD_DESCRIPTOR: flood_descriptor(); return OK;
    case PRINT_AND_ABORT: flood_stream(stdout); fputs("division by zero\n", stderr); abort();
    case LEAVE_A_FILE: leave_a_file(); return OK;
    default: return OK;
    }
}

int misbehave(Model *model, Phase phase) {
    if (phase == STEP)
        return misbehave_in_step(model);
    if (phase == INITIALIZATION && model->fault == HANG_IN_INITIALIZATION)
        hang();
    if (phase == INITIALIZATION && model->fault == CRASH_IN_INITIALIZATION)
        *nowhere = 1;
    if (phase == TERMINATE && model->fault == HANG_IN_TERMINATE)
        hang();
    if (phase == TERMINATE && model->fault == CRASH_IN_TERMINATE)
        *nowhere = 1;
    return OK;
}

int step(Model *model, double time, double size) {
    if (time >= model->fault_time - 1e-9) {
        int status = misbehave(model, STEP);
        if (status != OK)
            return status;
    }
    model->y += model->u * size;
    return OK;
}
