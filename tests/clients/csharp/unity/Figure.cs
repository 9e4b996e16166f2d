// An avatar with the verb's limbs, 1.5 times as long, other bone axes and lowered arms performs a pose; prints where
// its hand meets the goal and how far limbs are from their directions. Then it switches to a verb with three other
// adverbs and back, while the goal stands still, and once more with values for these adverbs.

using System;
using System.Collections.Generic;
using System.Reflection;
using System.Threading;
using Adverb;
using UnityEngine;

static class Figure
{
    const float Size = 1.5f;

    static int Main(string[] arguments)
    {
        var random = new System.Random(5);
        var client = new AdverbClient(arguments[0]);
        Skeleton skeleton = Frames.Flip(client.DescribeAsync("reach").GetAwaiter().GetResult().Skeleton);
        var figure = new AdverbFigure { server = arguments[0], speed = 0f, phase = 0.5f, goal = new Transform() };
        figure.transform.localPosition = new Vector3(2f, 0f, -1f);
        figure.transform.localRotation = new Quaternion(0f, (float)Math.Sin(0.4), 0f, (float)Math.Cos(0.4));
        Transform[] bones = Build(figure, skeleton, random);
        figure.goal.position = figure.transform.TransformPoint(Size * new Vector3(0.3f, 1.2f, 0.4f));
        Call(figure, "Start");
        var hand = bones[skeleton.IndexOf("RightHand")];
        Func<float> distance = () => (hand.position - figure.goal.position).magnitude;
        var row = new Dictionary<string, object>();
        row["reached_m"] = Play(figure, distance, 0.002f);
        row["limbs"] = Limbs(figure, skeleton, bones);
        Switch(figure, "locomotion");
        row["away_m"] = -Play(figure, () => -distance(), -0.3f);
        Switch(figure, "reach");
        row["reached_again_m"] = Play(figure, distance, 0.05f); // the root stands elsewhere now
        float[] expected = Locomotion(client, figure);
        Switch(figure, "locomotion");
        row["locomotion"] = Play(figure, () => Difference(figure, expected), 0.002f);
        Console.WriteLine(Json.Write(row));
        Call(figure, "OnDestroy");
        return 0;
    }

    static void Switch(AdverbFigure figure, string verb)
    {
        figure.Stream.SwitchAsync(figure.Channel, verb, phase: 0.5).GetAwaiter().GetResult();
    }

    /// <summary>Runs the figure until a value is small enough, at most 30 s; returns the value.</summary>
    static float Play(AdverbFigure figure, Func<float> value, float least)
    {
        float found = float.PositiveInfinity;
        DateTime end = DateTime.UtcNow.AddSeconds(30);
        while (found > least && DateTime.UtcNow < end)
        {
            Call(figure, "Update");
            Call(figure, "LateUpdate");
            found = value();
            Thread.Sleep(10);
        }
        return found;
    }

    /// <summary>Gives the figure adverbs for locomotion; returns the server's pose of them.</summary>
    static float[] Locomotion(AdverbClient client, AdverbFigure figure)
    {
        AdverbInfo[] adverbs = client.DescribeAsync("locomotion").GetAwaiter().GetResult().Adverbs;
        var goal = new Dictionary<string, double>();
        figure.adverbs = new float[adverbs.Length];
        for (int k = 0; k < adverbs.Length; k++)
        {
            figure.adverbs[k] = (float)(0.4 * adverbs[k].Min + 0.6 * adverbs[k].Max);
            goal[adverbs[k].Name] = figure.adverbs[k];
        }
        var options = new PoseOptions { Phase = 0.5 };
        WireRecord pose = client.PoseAsync("locomotion", goal, options).GetAwaiter().GetResult();
        Frames.FlipPose(pose.Values);
        return pose.Values;
    }

    /// <summary>Largest difference of the upper body's local rotations from those of a pose: standing feet of a stream
    /// stay where they are.</summary>
    static float Difference(AdverbFigure figure, float[] expected)
    {
        var pose = new AdverbPose();
        if (!figure.Channel.Sample(pose) || figure.Channel.Info.Verb != "locomotion") return float.PositiveInfinity;
        float worst = 0f;
        string[] names = figure.Channel.Info.Skeleton.Names;
        for (int j = 1; j < names.Length; j++)
        {
            if (names[j].Contains("Leg") || names[j].Contains("Foot") || names[j].Contains("Toe")) continue;
            float cosine = 0f;
            for (int k = 3 + 4 * j; k < 7 + 4 * j; k++) cosine += pose.Values[k] * expected[k];
            worst = Math.Max(worst, 1f - Math.Abs(cosine));
        }
        return worst;
    }

    static void Call(AdverbFigure figure, string name)
    {
        typeof(AdverbFigure).GetMethod(name, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(figure, null);
    }

    /// <summary>Bones with random axes; arms hang down by 40 degrees from the verb's rest pose.</summary>
    static Transform[] Build(AdverbFigure figure, Skeleton skeleton, System.Random random)
    {
        var rest = new float[3 + 4 * skeleton.Names.Length];
        rest[1] = 1f;
        for (int j = 0; j < skeleton.Names.Length; j++)
        {
            bool arm = skeleton.Names[j] == "LeftArm" || skeleton.Names[j] == "RightArm";
            double half = arm ? (skeleton.Names[j] == "LeftArm" ? 0.35 : -0.35) : 0.0;
            rest[3 + 4 * j + 2] = (float)Math.Sin(half);
            rest[3 + 4 * j + 3] = (float)Math.Cos(half);
        }
        var positions = new float[3 * skeleton.Names.Length];
        skeleton.Solve(rest, positions);
        var animator = new Animator();
        figure.Components[typeof(Animator)] = animator;
        var bones = new Transform[skeleton.Names.Length];
        for (int j = 0; j < bones.Length; j++)
        {
            int parent = skeleton.Parents[j];
            bones[j] = new Transform { parent = parent < 0 ? figure.transform : bones[parent] };
            bones[j].position = figure.transform.TransformPoint(Size * Point(positions, j));
            double angle = 6.0 * random.NextDouble();
            bones[j].rotation = new Quaternion((float)Math.Sin(angle), 0f, 0f, (float)Math.Cos(angle));
            HumanBodyBones name;
            if (AdverbFigure.Humanoid.TryGetValue(skeleton.Names[j], out name)) animator.Bones[name] = bones[j];
        }
        return bones;
    }

    /// <summary>Cosines between the directions of arms and legs and those of the verb's pose.</summary>
    static object Limbs(AdverbFigure figure, Skeleton skeleton, Transform[] bones)
    {
        var pose = new AdverbPose();
        figure.Channel.Sample(pose);
        var positions = new float[3 * bones.Length];
        skeleton.Solve(pose.Values, positions);
        var found = new List<object>();
        foreach (string name in new[] { "LeftForeArm", "LeftHand", "RightForeArm", "RightHand", "LeftLeg", "LeftFoot",
            "RightLeg" })
        {
            int j = skeleton.IndexOf(name), parent = skeleton.Parents[j];
            Vector3 theirs = Quaternion.Inverse(figure.transform.rotation) * (bones[j].position - bones[parent].position);
            Vector3 ours = Point(positions, j) - Point(positions, parent);
            found.Add((theirs.x * ours.x + theirs.y * ours.y
                + theirs.z * ours.z) / (theirs.magnitude * ours.magnitude));
        }
        return found;
    }

    static Vector3 Point(float[] positions, int joint)
    {
        return new Vector3(positions[3 * joint], positions[3 * joint + 1], positions[3 * joint + 2]);
    }
}
