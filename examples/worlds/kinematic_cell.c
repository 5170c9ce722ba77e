/* A simulator in C, without a library: every joint follows its set point, as in kinematic_cell.py.

   cc -O2 -o kinematic_cell examples/worlds/kinematic_cell.c
   safety-harness run FILE --world exec:./kinematic_cell                                                 */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST 8

static double joints_rad[MOST], speeds_radps[MOST], period_s;
static int count;

/* Read the array of numbers after a key; the keys of a message are unique. */
static int numbers(const char *line, const char *key, double *out) {
    const char *at = strstr(line, key);
    int n = 0;
    if (!at) return 0;
    for (at = strchr(at, '[') + 1; n < MOST && *at != ']'; n++) {
        char *end;
        out[n] = strtod(at, &end);
        at = *end == ',' ? end + 1 : end;
    }
    return n;
}

static void print_row(const double *row) {
    putchar('[');
    for (int i = 0; i < count; i++) printf("%s%.17g", i ? "," : "", row[i]);
    putchar(']');
}

static void say_state(long tick) {
    printf("{\"say\":\"state\",\"tick\":%ld,\"time_s\":%.17g,\"joint_position_rad\":", tick, tick * period_s);
    print_row(joints_rad);
    printf(",\"joint_velocity_radps\":");
    print_row(speeds_radps);
    printf(",\"joint_velocity_range_radps\":["); /* the least and the largest since the tick before */
    print_row(speeds_radps);
    putchar(',');
    print_row(speeds_radps);
    printf("]}\n");
}

int main(void) {
    char *line = NULL;
    size_t size = 0;
    while (getline(&line, &size, stdin) > 0) {
        if (strstr(line, "\"say\":\"hello\"")) {
            puts("{\"say\":\"hello\",\"protocol\":\"safety-harness world 1\",\"name\":\"kinematic cell in C\","
                 "\"version\":\"1\"}");
        } else if (strstr(line, "\"say\":\"reset\"")) {
            count = numbers(line, "\"joint_position_rad\"", joints_rad);
            period_s = strtod(strstr(line, "\"period_s\":") + 11, NULL);
            memset(speeds_radps, 0, sizeof speeds_radps);
            say_state(0);
        } else {
            numbers(line, "\"joint_velocity_radps\"", speeds_radps);
            for (int i = 0; i < count; i++) joints_rad[i] += speeds_radps[i] * period_s;
            say_state(strtol(strstr(line, "\"tick\":") + 7, NULL, 10) + 1);
        }
        fflush(stdout);
    }
    return 0;
}
