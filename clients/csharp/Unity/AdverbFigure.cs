// A humanoid avatar that performs a verb of a server. Add it to the object with the Animator; the avatar stands in its
// rest pose (T or A) when the scene starts. See clients/csharp/README.md.

using System;
using System.Collections.Generic;
using UnityEngine;

namespace Adverb
{
    /// <summary>Poses a humanoid avatar with the frames of a stream.</summary>
    public sealed class AdverbFigure : MonoBehaviour
    {
        /// <summary>Address of the server.</summary>
        public string server = "http://127.0.0.1:8000";

        /// <summary>Key; empty where the server requires none.</summary>
        public string key = "";

        /// <summary>Name of the verb.</summary>
        public string verb = "reach";

        /// <summary>Method of the verb; empty: that of the server.</summary>
        public string method = "";

        /// <summary>Goal of verbs with the adverbs x, y, z; the hand or foot meets it. May be empty.</summary>
        public Transform goal;

        /// <summary>Adverbs in the verb's order, where there is no goal; empty: the middle of the domain.</summary>
        public float[] adverbs = new float[0];

        /// <summary>Frames per second that are received.</summary>
        public int fps = 60;

        /// <summary>Speed of the motion; 0 holds it at <see cref="phase"/>.</summary>
        public float speed = 1f;

        /// <summary>Phase at the start, 0 to 1.</summary>
        public float phase;

        /// <summary>The avatar; by default that of this object.</summary>
        public Animator animator;

        readonly AdverbPose _pose = new AdverbPose();
        readonly List<Bone> _bones = new List<Bone>();
        AdverbStream _stream;
        AdverbChannel _channel;
        ChannelInfo _aimed;
        Skeleton _skeleton;
        float[] _positions, _rotations, _aim = new float[0];
        float _scale = 1f;

        sealed class Bone
        {
            internal int Joint;
            internal Transform Target;
            internal Quaternion Rest, Rotation, Correction;
            internal Vector3 Position;
        }

        /// <summary>The channel, for settings and switches; null before it is open.</summary>
        public AdverbChannel Channel { get { return _channel; } }

        /// <summary>The stream, for further channels and events; null before the start.</summary>
        public AdverbStream Stream { get { return _stream; } }

        async void Start()
        {
            if (animator == null) animator = GetComponent<Animator>();
            _stream = new AdverbStream(server, key.Length > 0 ? key : null);
            try
            {
                await _stream.ConnectAsync();
                var options = new OpenOptions { Fps = fps, Encoding = "q48", Frame = "unity", Speed = speed,
                    Phase = phase, Method = method.Length > 0 ? method : null };
                AdverbChannel channel = await _stream.OpenAsync(verb, options);
                Match(channel.Info.Skeleton);
                _channel = channel;
            }
            catch (AdverbException error)
            {
                Debug.LogError("Adverb: " + error.Message);
            }
        }

        void Update()
        {
            if (_channel == null) return;
            StreamEvent found;
            while (_stream.TryTakeEvent(out found))
                if (found.Error != null) Debug.LogWarning("Adverb: " + found.Error.Message);
            if (_channel.Switching) return;
            ChannelInfo info = _channel.Info;
            if (info != _aimed) _aim = new float[0]; // a switch without adverbs starts at the middle of the domain
            _aimed = info;
            if (goal != null && IsPoint(info.Adverbs)) Aim(Goal());
            else if (adverbs.Length == info.Adverbs.Length) Aim(adverbs);
        }

        // after the Animator, which would overwrite the bones
        void LateUpdate()
        {
            if (_channel == null || !_channel.Sample(_pose)) return;
            _skeleton.Solve(_pose.Values, _positions, _rotations);
            foreach (Bone bone in _bones)
            {
                int at = 4 * bone.Joint;
                var global = new Quaternion(_rotations[at], _rotations[at + 1], _rotations[at + 2], _rotations[at + 3]);
                if (bone.Joint == 0)
                    bone.Target.position = transform.TransformPoint(_scale * PointOf(_positions, 0));
                bone.Target.rotation = transform.rotation * global * bone.Correction;
            }
        }

        void OnDestroy()
        {
            if (_stream != null) _stream.Dispose();
        }

        static bool IsPoint(AdverbInfo[] adverbs)
        {
            return adverbs.Length == 3 && adverbs[0].Name == "x" && adverbs[1].Name == "y" && adverbs[2].Name == "z";
        }

        /// <summary>The goal in the figure's space, as adverbs: +X is to the left there.</summary>
        float[] Goal()
        {
            Vector3 point = transform.InverseTransformPoint(goal.position);
            return new[] { -point.x / _scale, point.y / _scale, point.z / _scale };
        }

        /// <summary>Sends a goal that differs from the last one.</summary>
        void Aim(float[] values)
        {
            bool same = values.Length == _aim.Length;
            for (int k = 0; same && k < values.Length; k++) same = values[k] == _aim[k];
            if (same) return;
            _channel.Aim(values);
            _aim = (float[])values.Clone();
        }

        /// <summary>Finds the avatar's bones, and what differs between both rest poses.</summary>
        void Match(Skeleton skeleton)
        {
            _skeleton = skeleton;
            _positions = new float[3 * skeleton.Names.Length];
            _rotations = new float[4 * skeleton.Names.Length];
            float[] rest = new float[3 + 4 * skeleton.Names.Length];
            for (int k = 6; k < rest.Length; k += 4) rest[k] = 1f;
            skeleton.Solve(rest, _positions);
            _bones.Clear();
            for (int j = 0; j < skeleton.Names.Length; j++)
            {
                HumanBodyBones name;
                if (!Humanoid.TryGetValue(skeleton.Names[j], out name)) continue;
                Transform target = animator.GetBoneTransform(name);
                if (target == null) continue; // chest, shoulders, toes and fingers are optional
                _bones.Add(new Bone
                {
                    Joint = j, Target = target, Rest = Quaternion.Inverse(transform.rotation) * target.rotation,
                    Position = transform.InverseTransformPoint(target.position),
                });
            }
            foreach (Bone bone in _bones) Correct(bone);
            _scale = Scale();
        }

        /// <summary>
        /// The rotation that brings the bone's limb to the direction of the joint's, then the bone's rest rotation. A
        /// bone at the end, or with several limbs, rotates as the bone above it.
        /// </summary>
        void Correct(Bone bone)
        {
            Bone above = Above(bone), child = null;
            int children = 0;
            foreach (Bone each in _bones)
            {
                if (Above(each) != bone) continue;
                child = each;
                children++;
            }
            bone.Rotation = above == null ? Quaternion.identity : above.Rotation;
            if (children == 1)
                bone.Rotation = Quaternion.FromToRotation(child.Position - bone.Position,
                    PointOf(_positions, child.Joint) - PointOf(_positions, bone.Joint));
            bone.Correction = bone.Rotation * bone.Rest;
        }

        /// <summary>The bone of the nearest mapped joint above; null for the root.</summary>
        Bone Above(Bone bone)
        {
            for (int j = _skeleton.Parents[bone.Joint]; j >= 0; j = _skeleton.Parents[j])
                foreach (Bone each in _bones) if (each.Joint == j) return each;
            return null;
        }

        /// <summary>Height of the avatar's hips above its lowest bone, relative to the verb's.</summary>
        float Scale()
        {
            if (_bones.Count == 0 || _bones[0].Joint != 0) return 1f;
            float lowest = _bones[0].Position.y, ours = 0f;
            foreach (Bone bone in _bones)
            {
                lowest = Math.Min(lowest, bone.Position.y);
                ours = Math.Max(ours, -_positions[3 * bone.Joint + 1]);
            }
            return ours > 0f && _bones[0].Position.y > lowest ? (_bones[0].Position.y - lowest) / ours : 1f;
        }

        static Vector3 PointOf(float[] positions, int joint)
        {
            return new Vector3(positions[3 * joint], positions[3 * joint + 1], positions[3 * joint + 2]);
        }

        /// <summary>Bones of humanoid avatars by the joints of the built-in verbs; add those of your own
        /// verbs.</summary>
        public static readonly Dictionary<string, HumanBodyBones> Humanoid = new Dictionary<string, HumanBodyBones>
        {
            { "Hips", HumanBodyBones.Hips }, { "Spine", HumanBodyBones.Spine }, { "Spine1", HumanBodyBones.Chest },
            { "Spine2", HumanBodyBones.UpperChest }, { "Neck", HumanBodyBones.Neck }, { "Head", HumanBodyBones.Head },
            { "LeftShoulder", HumanBodyBones.LeftShoulder }, { "LeftArm", HumanBodyBones.LeftUpperArm },
            { "LeftForeArm", HumanBodyBones.LeftLowerArm }, { "LeftHand", HumanBodyBones.LeftHand },
            { "LeftHandMiddle1", HumanBodyBones.LeftMiddleProximal },
            { "LeftHandThumb1", HumanBodyBones.LeftThumbProximal },
            { "RightShoulder", HumanBodyBones.RightShoulder }, { "RightArm", HumanBodyBones.RightUpperArm },
            { "RightForeArm", HumanBodyBones.RightLowerArm }, { "RightHand", HumanBodyBones.RightHand },
            { "RightHandMiddle1", HumanBodyBones.RightMiddleProximal },
            { "RightHandThumb1", HumanBodyBones.RightThumbProximal },
            { "LeftUpLeg", HumanBodyBones.LeftUpperLeg }, { "LeftLeg", HumanBodyBones.LeftLowerLeg },
            { "LeftFoot", HumanBodyBones.LeftFoot }, { "LeftToeBase", HumanBodyBones.LeftToes },
            { "RightUpLeg", HumanBodyBones.RightUpperLeg }, { "RightLeg", HumanBodyBones.RightLowerLeg },
            { "RightFoot", HumanBodyBones.RightFoot }, { "RightToeBase", HumanBodyBones.RightToes },
        };
    }
}
